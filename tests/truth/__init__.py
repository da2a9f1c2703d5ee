"""True scenes, their frames and sessions: closed forms that share no formula with the packages."""
