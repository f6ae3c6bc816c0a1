"""Model `faces`: straight, one-sided faces with visible stretches; exact for straight walls."""
