"""PicoQuant counters (PicoHarp 300, HydraHarp 400, MultiHarp 150) through the vendor's library."""
