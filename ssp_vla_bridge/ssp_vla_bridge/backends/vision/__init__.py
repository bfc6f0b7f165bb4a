"""Classical vision of the OpenCV baseline: ground, detections, tracks, and what they mean."""
