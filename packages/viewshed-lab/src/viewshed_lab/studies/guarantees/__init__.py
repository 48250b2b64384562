"""What cannot be over-claimed, measured: certificates, attacks on them, masks with a promised error."""
