"""Fields of models: density, colour and class at points."""
