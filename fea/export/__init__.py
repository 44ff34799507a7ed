"""What leaves the solver: VTK states, CalculiX decks, records of failures."""
