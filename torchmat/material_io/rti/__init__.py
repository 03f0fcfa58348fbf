"""Files of reflectance transformation imaging: coefficients in 8-bit codes, read and written by several programs."""
