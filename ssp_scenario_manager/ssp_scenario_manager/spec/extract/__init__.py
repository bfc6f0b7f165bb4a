"""From a source video to a candidate K* (METHOD 1, extraction): questions to a vision model."""
