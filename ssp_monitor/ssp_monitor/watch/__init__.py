"""What a session says of itself, as those hear it who only look on: the page and the view."""
