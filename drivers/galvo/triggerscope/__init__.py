"""TriggerScope-MM: a serial DAC and sequencer in front of an analogue galvo head."""
