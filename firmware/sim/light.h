/* The simulated flash and the photodiode that watches it, as the ADC sees them. */
#ifndef UNLIT_SIM_LIGHT_H
#define UNLIT_SIM_LIGHT_H

#include <stdint.h>

struct light {
    double dark;       /* level without flash, counts */
    double noise;      /* standard deviation of one sample, counts */
    double flicker;    /* amplitude of the room light's, counts */
    double flicker_hz;
    double energy;     /* of the flash, relative to nominal */
    double jitter;     /* its standard deviation, relative */
    double recycle_us; /* until then a trigger gives nothing */
    uint64_t random;   /* state of the generator; its start is the seed, not 0 */
    double fired_us, pulse; /* the last pulse, if pulse is not 0 */
};

/* The trigger rises: returns the energy that the flash gives. */
double light_fire(struct light *light, double now_us);
/* What the ADC makes of the light at this moment, in counts. */
uint16_t light_sample(struct light *light, double now_us);

#endif
