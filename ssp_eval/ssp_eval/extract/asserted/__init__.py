"""The parts of a text that it asserts (METHOD 5.5); the rules read nothing else.

blanked puts spaces in the place of fields that are denied (fields), of what a filled-in form leaves
empty (forms) and of options that weren't chosen (options).
"""
