"""What a scan will do: aim, patterns, dwell, order and duration; nothing here moves anything."""
