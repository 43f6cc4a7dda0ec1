"""The methods of Vodicheva & Parysheva (2019), with their accuracy formulas."""
