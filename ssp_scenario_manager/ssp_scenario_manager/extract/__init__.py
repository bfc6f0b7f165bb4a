"""The beginnings of a K*: a video and questions to a vision model, or a blank of its kind."""
