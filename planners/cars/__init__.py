"""Planning for cars: Reeds-Shepp and Dubins words, arc paths, shortcuts, detours, and returnable sets."""
