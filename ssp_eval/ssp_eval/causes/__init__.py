"""The causes that moved the answer: a model's answers to twins of a question, against its own."""
