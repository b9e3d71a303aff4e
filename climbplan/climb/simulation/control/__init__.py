"""What motors are commanded: feedforward of limbs' weight, and the regulator from joint angles."""
