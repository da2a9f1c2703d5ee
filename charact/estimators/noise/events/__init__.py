"""Single photoelectrons in dark frames."""
