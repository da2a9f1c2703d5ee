"""What stands between acquisition and the tube: interlock, bench, watchdog, safe action, dose."""
