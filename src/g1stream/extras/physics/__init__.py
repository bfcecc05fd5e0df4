"""The physics of a motion, and changes that let a robot play it on its feet."""
