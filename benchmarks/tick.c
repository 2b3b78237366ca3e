/* Times single ticks of exported code: tick SIGNALS SECONDS TORQUE ticks calls, binary files of a recorded run. */
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "ftc_step.h"

int main(int count, char **words) {
    if (count != 6) return 1;
    size_t ticks = strtoul(words[4], NULL, 10), calls = strtoul(words[5], NULL, 10);
    FILE *signals = fopen(words[1], "rb"), *seconds = fopen(words[2], "wb"), *torque = fopen(words[3], "wb");
    ftc_in *in = malloc(ticks * sizeof *in);
    double *taken = malloc(calls * sizeof *taken);
    ftc_real(*tau)[FTC_JOINTS] = malloc(ticks * sizeof *tau);
    if (!signals || !seconds || !torque || !in || !taken || !tau) return 1;
    if (fread(in, sizeof *in, ticks, signals) != ticks) return 1;
    ftc_state state;
    ftc_out out;
    for (size_t call = 0; call < ticks + calls; call++) { /* one lap to warm up */
        size_t k = call % ticks;
        struct timespec began, ended;
        if (k == 0) ftc_init(&state, in[0].reference.q);
        clock_gettime(CLOCK_MONOTONIC, &began);
        ftc_step(&state, &in[k], &out);
        clock_gettime(CLOCK_MONOTONIC, &ended);
        if (call >= ticks) taken[call - ticks] = (double)(ended.tv_sec - began.tv_sec) + 1e-9 * (double)(ended.tv_nsec - began.tv_nsec);
        for (size_t j = 0; j < FTC_JOINTS; j++) tau[k][j] = out.tau[j];
    }
    if (fwrite(taken, sizeof *taken, calls, seconds) != calls || fwrite(tau, sizeof *tau, ticks, torque) != ticks) return 1;
    return fclose(seconds) || fclose(torque);
}
