"""What cannot be over-claimed: an envelope that added returns only shrink, certificates, masks of a promised error."""
