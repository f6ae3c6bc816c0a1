"""Models as text and as plain data: equations, files, and the form in the user's own units."""
