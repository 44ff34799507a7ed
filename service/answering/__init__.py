"""From a query to its answer or its solve; knows no HTTP."""
