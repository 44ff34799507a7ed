"""The coupling paper (SIMULTECH 2017) reproduced: bar, spring, and an arm on a plate."""
