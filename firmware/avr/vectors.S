/* Interrupts whose first instructions matter. While the gate is open these, the 1 ms tick and a few held
 * instructions of the main loop are all that can delay the sync interrupt, so none keeps interrupts off for long. */
#include "board.h"

/* The contact closed. No register and no flag is touched until the trigger is up: sbis, sbi, cbi and jmp need none.
 * Of two edges at once the second waits until this one's C part returns, and finds the gate closed. */
.global INT0_vect
INT0_vect:
    sbis _SFR_IO_ADDR(GPIOR0), GATE
    rjmp 1f
    sbi _SFR_IO_ADDR(PORTD), TRIGGER
    cbi _SFR_IO_ADDR(GPIOR0), GATE
    sbi _SFR_IO_ADDR(GPIOR0), GATED
1:  jmp __vector_sync_edge

/* A byte from the host. Reading it ends the request for this interrupt, so others may come in from there on; the
 * next byte is at least 1300 cycles away. A full ring drops the byte: the line's checksum will tell. */
.global USART_RX_vect
USART_RX_vect:
    push r24
    lds r24, UDR0
    sei
    push r25
    in r25, _SFR_IO_ADDR(SREG)
    push r25
    push r30
    push r31
    lds r30, rx_head
    mov r25, r30
    inc r25
    andi r25, RX_RING - 1
    lds r31, rx_tail
    cp r25, r31
    breq 2f
    clr r31
    subi r30, lo8(-(rx_ring))
    sbci r31, hi8(-(rx_ring))
    st Z, r24
    sts rx_head, r25
2:  pop r31
    pop r30
    pop r25
    out _SFR_IO_ADDR(SREG), r25
    pop r25
    pop r24
    reti

/* The trigger's time is over. It fires every 32 ms at this phase, which does no harm: setting the time anew clears
 * a request that still waits. */
.global TIMER1_COMPA_vect
TIMER1_COMPA_vect:
    cbi _SFR_IO_ADDR(PORTD), TRIGGER
    reti

/* Wakes the main loop every millisecond. */
.global TIMER0_COMPA_vect
TIMER0_COMPA_vect:
    sbi _SFR_IO_ADDR(GPIOR0), TICK
    reti
