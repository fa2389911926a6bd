"""Pictures of tables of cases."""
