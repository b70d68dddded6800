"""The cheapest half-widths, mid-points and numbers of a design: decisions, units, margins, programme, certificate."""
