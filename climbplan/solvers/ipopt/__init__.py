"""IPOPT through CasADi: fixed integers, complementarity, and smooth programs of one's own."""
