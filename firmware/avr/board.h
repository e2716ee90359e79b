/* The board: ATmega328P at 16 MHz, as on an Arduino Uno or Nano. The one place where pins are named.
 *
 *   Arduino  pin  name      what is wired to it
 *   D2       PD2  SYNC      sync contact, closes to ground; pulled up inside
 *   D4       PD4  TRIGGER   to the flash's opto-coupler, active high; an external resistor pulls it low, so that it
 *                           is low in reset and in the boot loader, too
 *   D7       PD7  READY     the flash's ready output, high when charged; read only after cfg rdy=1. An external
 *                           resistor pulls it low: a wire that came off is a flash that is not ready
 *   D13      PB5  ARMED     the board's LED: the gate is open
 *   A0       PC0  LIGHT     photodiode behind its RC, 0 to 1.1 V; read by adc ch=0
 *   AREF                    the chip's own 1.1 V on the board's capacitor: never wire anything else to it
 *   D0, D1   PD0, PD1       UART, through the board's USB converter
 *
 * D13 would do as the trigger only until the boot loader blinks it. Included by C and by assembly. */
#ifndef UNLIT_BOARD_H
#define UNLIT_BOARD_H

#include <avr/io.h>

#define SYNC 2    /* of port D; INT0 */
#define TRIGGER 4 /* of port D */
#define READY 7   /* of port D */
#define ARMED 5   /* of port B */
#define LIGHT_CHANNEL 0
#define ADC_CHANNELS 1

/* Measured against the chip's own 1.1 V, so that no energy depends on the supply. */
#define REFERENCE (_BV(REFS1) | _BV(REFS0))

/* Bits of GPIOR0, which an interrupt tests and sets without touching a register. */
#define GATE 0  /* open: the next sync raises the trigger */
#define GATED 1 /* the sync interrupt raised the trigger; its C part has yet to say so */
#define TICK 2  /* a millisecond has passed */

/* Bytes of the ring that the receive interrupt fills, a power of two: more than one request. */
#define RX_RING 128

/* 16 MHz through U2X: 117647 baud, 2.1 % above 115200; UBRR of the next step is 3.5 % off, plain mode 3.5 % too. */
#define UBRR_115200 16

#endif
