"""How a LiDAR fires and measures: firing pattern, optics, weather, noise, range image."""
