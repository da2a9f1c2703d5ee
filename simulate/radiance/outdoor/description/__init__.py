"""A scene out of doors as its TOML file says it, and what the file may say."""
