"""The built-in scenes, one module each, all made up for this project."""
