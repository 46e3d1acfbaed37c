"""Where on a ray to ask: the samplers that models are made of."""
