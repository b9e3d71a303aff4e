"""Motor commands: gravity feedforward of the limbs, and the regulator from joint angles."""
