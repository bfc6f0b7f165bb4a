"""The words and phrases that the rules know, as data, and the one tree that finds them."""
