"""What each beam meets: solids and terrain, exactly."""
