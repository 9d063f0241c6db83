"""Many scans one after the other: forecast whole, carried out by themselves, resumed after anything."""
