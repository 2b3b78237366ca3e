/*
 * A 1 kHz control loop around ftc_step, with a stub in place of the drives.
 *
 *     cc -O2 example.c ftc_step.c -lm -o example && ./example
 *
 * Replace read_angles and write_torques by your drives' functions. The stub is an arm that follows its reference
 * exactly; after 0.2 s its first encoder is off by 0.1 rad.
 */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <time.h>

#include "ftc_step.h"

#define TICKS 400

static ftc_real angle[FTC_JOINTS]; /* rad, where the stub is */

static void read_angles(int tick, ftc_real q[FTC_JOINTS]) {
    for (int j = 0; j < FTC_JOINTS; j++) q[j] = angle[j];
    if (tick * FTC_SAMPLE_TIME >= 0.2) q[0] += (ftc_real)0.1;
}

static void write_torques(const ftc_real tau[FTC_JOINTS]) { (void)tau; }

static const char *word(int32_t verdict) {
    switch (verdict) {
        case FTC_NORMAL: return "normal";
        case FTC_ACTUATOR: return "actuator";
        case FTC_SENSOR: return "sensor";
        case FTC_BOTH: return "both";
        case FTC_CONTACT: return "contact";
        default: return "unknown";
    }
}

static void wait_until(struct timespec *next) {
    next->tv_nsec += (long)(1e9 * FTC_SAMPLE_TIME);
    while (next->tv_nsec >= 1000000000L) {
        next->tv_nsec -= 1000000000L;
        next->tv_sec++;
    }
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, next, NULL) != 0) continue;
}

int main(void) {
    static const char *const names[] = FTC_JOINT_NAMES;
    int32_t said[FTC_JOINTS] = {0};
    ftc_state state;
    ftc_out out;
    ftc_in in = {0};
    struct timespec next;

    read_angles(0, in.measurement.q);
    ftc_init(&state, in.measurement.q); /* at rest, holding against gravity */
    for (int j = 0; j < FTC_JOINTS; j++) {
        in.reference.q[j] = in.measurement.q[j];
        in.measurement.tau[j] = (ftc_real)NAN; /* no command yet */
    }

    clock_gettime(CLOCK_MONOTONIC, &next);
    for (int tick = 0; tick < TICKS; tick++) {
        wait_until(&next);
        read_angles(tick, in.measurement.q);
        ftc_step(&state, &in, &out);
        write_torques(out.tau);
        for (int j = 0; j < FTC_JOINTS; j++) {
            in.measurement.tau[j] = out.tau[j]; /* or what the drive says that it made of it */
            if (out.verdict[j] != said[j]) printf("%g s %s: %s\n", tick * FTC_SAMPLE_TIME, names[j], word(out.verdict[j]));
            said[j] = out.verdict[j];
        }
    }
    printf("%d ticks\n", TICKS);
    return 0;
}
