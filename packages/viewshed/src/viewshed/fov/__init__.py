"""What a sensor sees: the definition of visible, FovEstimate, Truth, heights of the ground, polygons."""
