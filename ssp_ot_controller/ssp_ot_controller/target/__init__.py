"""The object target: takes references, tracks them, and stops by itself when it must."""
