"""What cars need beyond the search: words of Reeds and Shepp, arc paths, shortcuts, detours, and what a Dubins car can return from."""
