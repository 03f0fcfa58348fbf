"""One recipe a model: how its maps are found from samples."""
