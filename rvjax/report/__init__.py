"""What a person reads: tables with units, results folders, pages, pictures."""
