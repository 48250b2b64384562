"""Detections and views to tracks: objects over time that know what could be seen of them."""
