"""Transfer audit (METHOD 4): do three recordings show the same event, and may they be scored?"""
