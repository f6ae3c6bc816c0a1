"""Model `narmax`: each ray as a polynomial of lagged poses, the twist, lagged readings and lagged noise."""
