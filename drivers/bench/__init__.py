"""Test bench of the tube: interlock, bench server and client, safe state, dose."""
