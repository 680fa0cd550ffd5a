"""How far the paper's results carry: its cases over noise seeds, and chains of growing nonlinearity."""
