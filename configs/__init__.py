"""YAML files and the base of everything they may say."""
