"""Labels of a clip (METHOD 5.1 to 5.2b): planned, proposed, checked, reviewed, shown."""
