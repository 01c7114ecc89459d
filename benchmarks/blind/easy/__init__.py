"""The easy set: tables of published forms that the catalogue has, made by another implementation without law errors."""
