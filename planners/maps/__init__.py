"""Map formats -> Arena, one file each; registry MAPS."""
