"""Models as text and as plain data: equations, files, and conversion to the units of the user."""
