"""Verify a certificate of ``uavaou gap`` with NumPy and SciPy alone: ``python verify_certificate.py FILE``.

It reads the scenario, the devices and the multipliers, and computes the bound that they prove by its own dynamic
programs. Nothing of the package is imported.
"""

import json
import sys

import numpy as np
from scipy.stats import ncx2

FAR = 1e15  # a price that nobody pays


class Mission:
    """The grid, the CDS, the age of every gap and the probabilities of coverage."""

    def __init__(self, file):
        fields = self.fields = json.loads(str(file["scenario"]))
        step, self.slots = fields["grid_step_m"], fields["slots"]
        size = [round(fields["area_x_m"] / step) + 1, round(fields["area_y_m"] / step) + 1]
        cells = np.array([(x, y) for x in range(size[0]) for y in range(size[1])])
        moves = cells[:, None] + [[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]]
        self.inside = ((moves >= 0) & (moves < size)).all(-1)  # (C, 5)
        self.to = np.where(self.inside, moves[..., 0] * size[1] + moves[..., 1], np.arange(len(cells))[:, None])
        cds = np.rint(np.array(fields["cds_m"]) / step).astype(int)
        self.homes = cds[:, 0] * size[1] + cds[:, 1]
        heights = np.array(fields["altitudes_m"], float)
        length = np.floor(((fields["flight_time_budget_s"] + 1e-6) * fields["speed_m_s"] - 2 * heights) / step)
        free = fields["flight_time"] == "ignore"
        self.budget = np.full(len(heights), self.slots) if free else length.astype(int)
        away = np.abs(cells[None] - cds[:, None]).sum(-1)
        self.near = 2 * away <= self.budget[:, None]  # (U, C)
        ground = ((cells[:, None] * step - file["positions"]) ** 2).sum(-1)  # (C, I)
        distance2 = ground + heights[:, None, None] ** 2  # (U, C, I)
        gain_db = fields.get("reference_gain_db")
        wave = 299_792_458 / (4 * np.pi * fields["carrier_frequency_hz"]) if gain_db is None else 0
        gain = wave**2 if gain_db is None else 10 ** (gain_db / 10)
        loss_db = fields.get("excess_loss_db", 0) - fields.get("antenna_gain_db", 0)
        if sight := fields.get("line_of_sight"):
            sine = heights[:, None, None] / np.sqrt(distance2)
            seen = 1 / (1 + sight["a"] * np.exp(-sight["b"] * (np.degrees(np.arcsin(sine)) - sight["a"])))
            loss_db = loss_db + seen * sight["loss_los_db"] + (1 - seen) * sight["loss_nlos_db"]
        loss = distance2 ** (fields.get("path_loss_exponent", 2) / 2) * 10 ** (loss_db / 10)
        snr = file["transmit_power"] * gain / 10 ** (fields["noise_power_dbm"] / 10 - 3) / loss
        need = 2.0 ** (fields.get("rate_min_bit_s", 0) / file["bandwidth"]) - 1
        if (least_db := fields.get("snr_min_db")) is not None:
            need = 10 ** (least_db / 10)
        if (least_dbm := fields.get("sensitivity_dbm")) is not None:
            need = 10 ** ((least_dbm - fields["noise_power_dbm"]) / 10)
        phi = fields["rician_factor"]
        fades = fields["fading"] != "none"
        self.hit = ncx2.sf(2 * (phi + 1) * need / snr, 2, 2 * phi) if fades else (snr >= need) * 1.0
        self.periods = [int(k) for k in file["update_period"]]
        self.ages = [self.age_of_gaps(k) for k in self.periods]

    def age_of_gaps(self, period):
        """Age of a device in slot t if it was last collected in s, by the literal recursion; [s, t]."""
        ages = np.zeros((self.slots + 1, self.slots + 2))
        for s in range(self.slots + 1):
            waiting, age = int(s == 0), 0
            for t in range(s + 1, self.slots + 1):
                waiting += t % period == 0
                age += waiting
                ages[s, t] = age
        return ages

    def walk(self, uav, price):
        """Largest sum of prices, [t] -> (C, 5) for the move after slot t, of a walk from the CDS and back to it."""
        value = np.where(np.arange(len(self.to)) == self.homes[uav], 0.0, -FAR)
        for t in range(self.slots - 1, 0, -1):
            value = np.where(self.inside & self.near[uav][self.to], price(t) + value[self.to], -FAR).max(1)
        return value[self.homes[uav]]


def fleet(mission, prices):
    total, slots = 0.0, mission.slots
    uavs = len(mission.homes)
    for i, ages in enumerate(mission.ages):
        miss = np.ones(())
        for u in range(uavs):
            miss = np.multiply.outer(miss, 1 - mission.hit[u, :, i])
        miss = miss[..., None]  # (C, ..., C, 1)
        after = np.full((*miss.shape[:-1], slots + 1), FAR)  # by the gap after the slot
        after[tuple(mission.homes)] = 0.0
        for t in range(slots, 0, -1):
            gap = np.arange(1, slots + 1)
            old = np.where(gap <= t, ages[np.maximum(t - gap, 0), t], 0.0)
            before = (1 - miss) * after[..., :1] + miss * (old + after[..., 1:])
            before = np.concatenate([before, before[..., -1:]], -1)  # a gap of K before a slot does not occur
            if t == 1:
                total += before[(*mission.homes, 0)]
                break
            for u in range(uavs):
                allowed = mission.inside & mission.near[u][mission.to]
                cost = np.where(allowed, prices[t - 1, u, i], FAR)  # (C, 5)
                there = np.moveaxis(before, u, 0)
                before = np.moveaxis(
                    np.min([cost[:, m].reshape(-1, *[1] * uavs) + there[mission.to[:, m]] for m in range(5)], 0), 0, u
                )
            after = before
    return total - sum(mission.walk(u, lambda t, u=u: prices[t, u].sum(0)) for u in range(uavs))


def copies(mission, charges, prices, differences):
    total, slots, uavs, gaps = 0.0, mission.slots, len(mission.homes), differences.shape[-1] - 1
    # The prices after slot t: one for each slot of the mission, or of the device's period, or one for all.
    every = [slots + 1 if len(prices) == slots + 1 else min(k, len(prices)) for k in mission.periods]
    longer = np.minimum(np.arange(gaps + 1) + 1, gaps)
    for i, ages in enumerate(mission.ages):
        summed = np.cumsum(ages, 1)
        charged = np.concatenate([[0.0], np.cumsum(charges[:, i])])
        toll, age = np.zeros((slots + 1, uavs, gaps + 1)), np.zeros((slots + 1, gaps + 1))
        for t in range(1, slots + 1):
            worth, known = np.zeros(gaps + 1), min(t, gaps)
            worth[1 : known + 1] = (charged[t] - charged[:t] - summed[:t, t - 1])[::-1][:known]  # gaps of 1, 2, ...
            toll[t] = np.maximum(0.0, worth / uavs + differences[t % mission.periods[i], :, i])
            age[t, 1 : known + 1] = ages[:t, t][::-1][:known]
        for u, home in enumerate(mission.homes):
            hit, earned = mission.hit[u, :, i][:, None], toll.sum(1) - toll[:, u]
            after = np.full((len(hit), gaps + 1), FAR)  # by the gap of the fleet after the slot
            after[home] = 0.0
            for t in range(slots, 0, -1):
                missed = np.minimum(age[t, longer] / uavs + after[:, longer], toll[t, u, longer] + after[:, :1])
                before = hit * (after[:, :1] - earned[t, longer]) + (1 - hit) * missed
                cost = np.where(mission.inside, prices[(t - 1) % every[i], u, i], FAR)
                after = np.min([before[mission.to[:, m]] + cost[:, m, None] for m in range(5)], 0)
            total += before[home, 0]
    mission.near = np.ones_like(mission.near)
    for u in range(len(mission.homes)):
        total -= mission.walk(u, lambda t, u=u: sum(prices[t % k, u, i] for i, k in enumerate(every)))
    return total


def collections(mission, prices, step_prices):
    total, slots = 0.0, mission.slots
    for i, ages in enumerate(mission.ages):
        gaps = np.pad(np.cumsum(ages, 1), ((0, 0), (1, 0)))[:, :-1]  # [s, t] between collections in s and t
        least = np.zeros(slots + 2)
        for t in range(1, slots + 2):
            least[t] = (least[:t] + gaps[:t, t]).min() + (prices[t, i] if t <= slots else 0.0)
        total += least[-1]
    for u, home in enumerate(mission.homes):
        worth = prices @ mission.hit[u].T  # (K+1, C)
        step = np.where(mission.to == np.arange(len(mission.to))[:, None], 0.0, step_prices[u])
        total -= worth[1, home] + step_prices[u] * mission.budget[u]
        total -= mission.walk(u, lambda t, worth=worth, step=step: worth[t + 1][mission.to] - step)
    return total


def verify(path):
    """Return the bound that the certificate claims and the one that its multipliers prove, in s."""
    file = np.load(path)
    mission = Mission(file)
    multipliers = {name[11:]: file[name] for name in file.files if name.startswith("multiplier_")}
    proof = {"fleet": fleet, "copies": copies}.get(str(file["method"]), collections)
    proven = proof(mission, **multipliers) * mission.fields["slot_length_s"] / mission.slots
    return float(file["mean_aou_s"]), proven


if __name__ == "__main__":
    claimed, proven = verify(sys.argv[1])
    print(f"claimed {claimed:.9g} s, proven {proven:.9g} s")
    sys.exit(int(claimed > proven * (1 + 1e-7)))
