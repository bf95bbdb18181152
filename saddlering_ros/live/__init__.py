"""A page in the browser on which a test is watched as it runs, over the real topics."""
