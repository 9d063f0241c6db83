"""The `tcspc488` histogrammer over USBTMC: per-point histograms and T3 list mode."""
