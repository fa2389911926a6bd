"""Tables of cases: scenes, views, methods and scales, measured one by one."""
