"""Models, services of models, and answers of known cause."""
