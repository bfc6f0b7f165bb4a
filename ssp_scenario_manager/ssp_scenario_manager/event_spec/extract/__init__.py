"""The beginnings of a K*: a video and questions to a vision model, its kind, or an older form."""
