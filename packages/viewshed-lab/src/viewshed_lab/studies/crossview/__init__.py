"""What one posed sweep tells about the estimate of another: over- and under-claim without labels."""
