"""What makes the pages about results: `make results`, `make ablations`. Not part of the package."""
