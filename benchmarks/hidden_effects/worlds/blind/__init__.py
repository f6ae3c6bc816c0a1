"""The blind world, by an author who had read two reference pages and no code of the product."""
