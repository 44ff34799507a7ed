"""By how much deviations are multiplied to hold a level of errors."""
