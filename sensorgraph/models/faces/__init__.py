"""Model `faces`: straight, one-sided faces with visible stretches; exact where walls are straight."""
