"""From one photograph, with stand-ins for generated pictures: what their faults cost, by stage."""
