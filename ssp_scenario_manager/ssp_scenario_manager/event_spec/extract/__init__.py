"""How a K* begins: from a video by questions to a vision model, blank from its kind, or from an
older form.
"""
