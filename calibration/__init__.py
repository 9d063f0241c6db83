"""From raw counts to counts that the physics can use."""
