"""LiDAR model: firing pattern, optics, weather, noise, range image."""
