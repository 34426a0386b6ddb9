"""Plants: MuJoCo with model mismatch, sensors, rendering."""
