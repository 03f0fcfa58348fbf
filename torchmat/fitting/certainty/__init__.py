"""How certain the maps of a fit are, and which photographs would make them more so."""
