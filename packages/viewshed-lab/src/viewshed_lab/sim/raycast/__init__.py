"""Ray caster: exact first hits of beams on solids and terrain."""
