"""Pictures of designs; matplotlib is imported only when one is drawn."""
