"""A leveled sweep to detections: boxes of what stands on the ground, and how surely such a box is found."""
