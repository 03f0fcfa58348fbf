"""A page beside any drawing program: a material is seen, changed, undone and compared while its maps are painted."""
