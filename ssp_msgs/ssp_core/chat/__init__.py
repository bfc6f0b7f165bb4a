"""Chat services of language models: requests, retries, errors, and the answer in an output."""
