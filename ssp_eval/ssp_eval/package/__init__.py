"""Evidence packages (METHOD 4): everything behind a score in one folder, every link a hash."""
