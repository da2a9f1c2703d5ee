"""What stands between acquisition and the tube: interlock, bench server and its client, safe action, dose."""
