"""The PettingZoo environment and its flattening; import the modules, not this package."""
