"""CSV, XLSX, Parquet, JSON, HDF5 and MAT files to rows in SI with named mistakes, and back."""
