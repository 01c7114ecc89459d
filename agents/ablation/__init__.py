"""Does the identifier help? Agents of several variants, trained and compared on several scenarios."""
