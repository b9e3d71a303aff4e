"""IPOPT through CasADi: pinned programs, complementarity, and smooth programs of one's own."""
