"""What one simulation needs of a component: the plan, and the table that holds no more than it."""
