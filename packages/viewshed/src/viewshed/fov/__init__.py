"""The field of view: the definition of visible, FovEstimate, Truth, ground heights, polygons."""
