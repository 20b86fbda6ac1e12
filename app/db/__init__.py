"""Tables, and how to open the database."""
