"""Tables of scores, as reports, CSV and LaTeX show them, and the notices beside them."""
