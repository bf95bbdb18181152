"""The verdict on the selected model, its published numbers, and steady lines."""
