"""Labels of a clip (METHOD 5.2): what a careful reader says is true at each label time."""
