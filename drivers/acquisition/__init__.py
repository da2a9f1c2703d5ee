"""From a plan to a session: checked, forecast, run step by step, paused, stopped, resumed."""
