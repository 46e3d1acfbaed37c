"""What is at a point: the fields that models are made of."""
