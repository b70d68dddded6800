"""Material of discs and pins in the contact laws, s1 = (1 - nu^2)/E of the disc and s2 of the pin."""

import jax
import jax.numpy as jnp

from rvjax.designs import Contact


def plane(contact: Contact) -> jax.Array:
    """(s1 + s2)/pi, 1/Pa: over the face width, c of the hertz contact law.

    Args:
        contact: of discs and pins.
    """
    if contact.pin_young_modulus is None:
        return jnp.asarray(2 * (1 - contact.poisson_ratio**2) / (jnp.pi * contact.young_modulus))
    return jnp.asarray(sum(contact.compliances) / jnp.pi)


def level(contact: Contact, rounding: jax.Array) -> jax.Array:
    """A of the hertz contact law with a rigid support: ln(4 pi L r^2/((s1 + s2) R*)) - (s2 + s1 nu/(1 - nu))/(s1 + s2).

    Args:
        contact: of discs and pins.
        rounding: r^2/R* of a pin of radius r, m.
    """
    nu = contact.poisson_ratio
    if contact.pin_young_modulus is None:  # Eq. 17
        stiff = contact.young_modulus * contact.face_width / (1 - nu**2)
        return jnp.asarray(jnp.log(2 * jnp.pi * stiff * rounding) - 1 / (2 * (1 - nu)))
    disc, pin = contact.compliances
    whole = disc + pin
    return jnp.asarray(
        jnp.log(4 * jnp.pi * contact.face_width / whole * rounding) - (pin + disc * nu / (1 - nu)) / whole
    )
