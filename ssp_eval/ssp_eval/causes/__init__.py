"""What moved the answer: a model's answers to twins of a question, compared with its own."""
