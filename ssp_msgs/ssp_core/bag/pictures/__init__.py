"""The pictures of a bag, and what their headers and stamps claim."""
