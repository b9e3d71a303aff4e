"""What a URDF alone lets one propose of a robot: legs, toes, postures, stiffness."""
