"""The database: its tables, connections, migrations and transactions."""
