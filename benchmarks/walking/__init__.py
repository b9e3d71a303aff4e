"""What walking methods take and reach, beside published figures."""
