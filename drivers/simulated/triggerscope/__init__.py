"""A simulated TriggerScope-MM with a galvo head behind it."""
