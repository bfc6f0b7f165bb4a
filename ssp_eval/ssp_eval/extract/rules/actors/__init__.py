"""Who is who: which road user a noun names, and when it names the ego."""
