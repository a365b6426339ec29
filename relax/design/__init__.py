"""The inverse problem: its statement, its judge, and the methods that solve it."""
